"""Run time against error: `python -m benchmarks`."""
