"""Golden answers: what handsight answers today, kept to be compared bit for bit with what another version answers.

    python -m benchmarks.golden record FOLDER
    python -m benchmarks.golden compare FOLDER

Some 2 800 corrections are drawn from fixed seeds, with NumPy alone. Ten recordings are simulated once, while
recording, and lie in FOLDER beside the answers, which are plain numbers (.npz) and words (.json). Forty depth images
are real ones of the data folder. Objects are built
anew in each run. A near tie that flipped is an answer whose pose has moved by more than 1 mm or 1°. Bits are promised
on one machine only, with the same versions of Python, NumPy and the compiler.
"""
