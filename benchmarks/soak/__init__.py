"""Random problems by the hundred thousand: what a solve must never do, whatever it is given."""
