"""Solids in the way of a robot: scenes, clearance, and self-motion that avoids them."""
