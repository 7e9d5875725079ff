"""Planning of the self-motion."""
