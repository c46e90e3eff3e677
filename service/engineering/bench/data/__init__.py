"""Measurements of a real robot that ship for the bench; what they are is in README.md beside this file."""
