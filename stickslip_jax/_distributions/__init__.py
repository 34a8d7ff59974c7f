"""Distributions of random numbers: what differs from sample to sample of an ensemble."""
