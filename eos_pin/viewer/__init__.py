"""Live view and replay in the browser."""
