"""The paper's examples, claims and figures."""
