"""Floor 2, synthetic captures with ground truth; shares no code with the solvers."""
