"""Files of a run: trajectories, checkpoints, the log; pictures and exports of them."""
