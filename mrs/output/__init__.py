"""Files of a run: trajectories, checkpoints, the log, and what is made of them afterwards."""
