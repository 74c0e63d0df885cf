"""Constant inputs and offsets, chosen by an optimizer."""
