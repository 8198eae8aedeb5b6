"""The gap between simulator and recordings: where it lies, which effect causes it, how far it shrinks with it."""
