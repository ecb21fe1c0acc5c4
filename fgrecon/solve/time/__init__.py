"""One vehicle over time: its heading by all frames, the graph of a window, and what is left of frames before it."""
