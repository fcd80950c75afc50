"""How close simulated images come to real ones, and fitting the simulation to them."""
