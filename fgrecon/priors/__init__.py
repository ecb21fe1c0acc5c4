"""Shape and size priors."""
