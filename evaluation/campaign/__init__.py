"""The training campaign: data, trainings and reports in one command that goes on where it stopped.

Every step is a command of `simnfnd` in a process of its own.
"""
