"""One program a peer. Each runs in a process of its own, perhaps under an interpreter of its own, with numpy only.

A program has one function a topic: arrays in, ``measure`` to time itself with, arrays out. It may import its peer
and numpy, nothing of ours, and nothing at import time that would hide that the peer is missing.
"""
