"""High-precision reference computations that the tests judge the package by."""
