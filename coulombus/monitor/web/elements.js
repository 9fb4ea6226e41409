"use strict";
// Elements by what they show or do: the helpers of all scripts.

const one = (name) => document.querySelector(`[data-signal="${name}"]`);
const action = (name) => document.querySelector(`[data-action="${name}"]`);

const put = (name, text) => {
  const element = one(name);
  const shown = text === "" || text === null || text === undefined ? "-" : String(text);
  if (element.textContent !== shown) element.textContent = shown;
  return element;
};
