"""Long runs that are killed at random times, again and again: what comes out is what comes out undisturbed."""
