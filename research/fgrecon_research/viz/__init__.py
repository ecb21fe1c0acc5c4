"""Pictures of evaluations and of labels, drawn with the means of `fgrecon.viz`."""
