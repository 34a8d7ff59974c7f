"""Derivatives of stick statistics with respect to parameters, corrected for sticks that appear and vanish."""
