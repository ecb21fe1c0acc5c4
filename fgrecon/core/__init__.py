"""What is known, what is asked and what comes back: frozen data, checks and errors. No I/O."""
