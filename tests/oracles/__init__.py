"""What tests compare with: independent solutions, and recordings spoiled in known ways."""
