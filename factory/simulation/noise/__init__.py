"""Adds the noise of a real sonar: `registry` lists the effects, `draws` draws them."""
