"""Benchmarks against peers on the same data in one run: ratios of one machine, never absolute promises."""
