"""The training campaign: data, trainings and reports in one command that goes on where it stopped.

Every step is a command of `factory`, `models` or `evaluation`, in a process of its own.
"""
