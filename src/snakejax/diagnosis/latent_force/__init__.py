"""The force that no known effect explains: its estimate over time, and what it depends on."""
