"""The noise of a real receiver, on the polar field; for acoustics.formation=field.

Effects of stage "echo" take and give a `Signal` before the device has blurred it, those of "beam"
and "picture" the complex field after beamforming, before and after time-varying gain.
"""
