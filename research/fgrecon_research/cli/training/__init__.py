"""Commands that label images, measure and train networks, and learn priors."""
