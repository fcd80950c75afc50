"""The noise of a real sonar, one file an effect; `registry` lists them, `draws` draws them.

`points` holds the paper's effects (section 3.3), which make or move echoes; `field` those of a real
receiver, which act on the complex field of acoustics.formation=field.
"""
