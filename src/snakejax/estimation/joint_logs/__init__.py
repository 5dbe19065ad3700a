"""Joint logs with a clock and noise of their own, estimated together with the parameters."""
