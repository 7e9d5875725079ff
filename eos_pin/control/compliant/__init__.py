"""Compliant control: stiffness and damping of the task and of the self-motion, in physical units."""
