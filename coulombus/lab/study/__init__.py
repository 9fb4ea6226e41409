"""Experiments with people: a study's file, its trials, who answers, and what is kept of it."""
