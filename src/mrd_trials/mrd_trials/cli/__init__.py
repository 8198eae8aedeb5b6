"""Tools without a graph."""
