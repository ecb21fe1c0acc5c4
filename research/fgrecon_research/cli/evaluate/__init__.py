"""Commands that compare fgrecon with other methods on data with known poses."""
