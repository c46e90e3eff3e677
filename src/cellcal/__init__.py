"""Calibration of industrial robot cells."""
