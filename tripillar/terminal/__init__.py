"""What every command shares: output, progress, errors, interrupts."""
