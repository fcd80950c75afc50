"""The paper's noise: echoes that are moved or added (Yang et al. 2024, section 3.3)."""
