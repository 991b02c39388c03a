"""What tests and benchmarks share: oracles, kernels, and cases with their bounds."""
