"""Files of every kind, damaged at random: no reader raises anything but what fgrecon raises on purpose."""
