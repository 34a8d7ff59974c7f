"""What differs from sample to sample: distributions, designs, and the numbers of a model that take their values."""
