"""Cost as workers, hosts and datasets grow."""
