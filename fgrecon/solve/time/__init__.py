"""One vehicle over time: its heading by all frames, the graph of a window, and the marginal of earlier frames."""
