"""Designs: which numbers and which realisation each sample of an ensemble takes."""
