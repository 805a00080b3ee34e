"""Compilation of hot loops: vector types, elementary functions, array views and the kernel cache."""
