"""Whole switching patterns, chosen by an optimizer."""
