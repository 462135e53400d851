"""Training time against error: the three trainers, torch's own and two peers on the same data, network and start.

Open `contenders.py` first (ours, and how one is measured), then `peers.py` (the others) and `problem.py` (the
samples and the network that all are handed, and a trace of the error over time).
"""
