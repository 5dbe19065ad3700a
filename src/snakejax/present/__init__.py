"""Results as JSON, as text, as figures and as pages."""
