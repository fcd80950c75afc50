"""How far detectors come on real images that learned from simulated ones: `evaluate transfer`."""
