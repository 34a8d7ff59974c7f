"""Benchmarks: the interval engine beside honest yardsticks, in one run. `make bench`; results in README.md."""
