"""Learning shape priors and networks."""
