"""Training time against error: the three trainers, torch's own and two peers on the same data, network and start.

In: simulated samples and the form of a network. Out: a table, ratios, a JSON and a picture for each case. Open
`contenders.py` first (ours), then `peers.py` (the others), `problem.py` (what all are handed) and `race.py` (how each
is timed in a process of its own).
"""
