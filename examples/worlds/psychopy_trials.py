"""Trials in PsychoPy: two friction levels one after the other, and which of them was stronger.

python examples/worlds/psychopy_trials.py                     beside `coulombus run --world`; needs psychopy
"""

import random

from coulombus import connect

STANDARD_NM, DIFFERENCES_NM = 1.0, (0.1, 0.2, 0.4)
LOOK_S = 3.0


def levels_of(trial, seed=1):
    """Return both levels of F_d [Nm] of a trial, and the key of the right answer."""
    lottery = random.Random(f"{seed}/{trial}")
    stronger = STANDARD_NM + lottery.choice(DIFFERENCES_NM)
    levels = [STANDARD_NM, stronger]
    lottery.shuffle(levels)
    return levels, str(1 + levels.index(stronger))


def feel(hand, level_Nm, clock):
    """Display a level for `LOOK_S`; return the way of the hand [rad]."""
    hand.set(F_s_Nm=1.1 * level_Nm, F_d_Nm=level_Nm)
    clock.reset()
    here_rad, way_rad = hand.state.x_rad, 0.0
    while clock.getTime() < LOOK_S:
        x_rad = hand.next().x_rad
        way_rad += abs(x_rad - here_rad)
        here_rad = x_rad
    return way_rad


def main(trials=20):
    """Run the trials; print the answers as CSV."""
    from psychopy import core, event, visual

    window, clock = visual.Window(fullscr=False), core.Clock()
    text = visual.TextStim(window)

    def show(words):
        text.text = words
        text.draw()
        window.flip()

    print("trial,first_Nm,second_Nm,answer,right,way_1_rad,way_2_rad")
    with connect("coulombus:bench") as hand:
        for trial in range(trials):
            levels, right = levels_of(trial)
            ways = []
            for number, level_Nm in enumerate(levels, 1):
                show(f"{number}: turn the handle")
                ways.append(feel(hand, level_Nm, clock))
            show("Which was stronger? 1 or 2")
            (answer,) = event.waitKeys(keyList=["1", "2"])
            print(trial, *levels, answer, int(answer == right), *(f"{way:.3f}" for way in ways), sep=",")


if __name__ == "__main__":
    main()
