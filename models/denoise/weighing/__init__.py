"""Which weights denoise a picture: those that suit its noise, or several in turn."""
