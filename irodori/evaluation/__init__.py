"""Errors against ground truth, photographs and converged references, and their prediction."""
