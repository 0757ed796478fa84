"""Gray-box online observer of DC motors."""
