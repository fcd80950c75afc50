"""Trains denoisers on the factory's pairs and on recordings, and denoises images.

`simnfnd.models.networks` has the contract between them.
"""

WEIGHTS_NAME = "weights.safetensors"
"""The weights file of a training; named here, where importing it does not load torch."""
CONFIG_NAME = "config.yaml"
"""All settings of a training, after a line with its command."""
COMMAND_MARK = "# "
"""What that line begins with."""

if __name__ == "models":
    from simnfnd.rooms import refuse_modules_of

    refuse_modules_of(__name__)
