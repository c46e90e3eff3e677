"""Worlds and builders for the unit tests."""
