"""Self-motion manifolds: components, their arcs within limits, and coverings."""
