"""Parts that all commands share: output, progress, errors, interrupts."""
