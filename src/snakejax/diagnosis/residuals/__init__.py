"""What a fitted model leaves: when, where, and with what it goes."""
