"""Networks that the SimNFND paper names, after their abstracts; **not reproduced**.

Neither their code nor their tables of layers were at hand: sizes, and all that an abstract leaves
open, are ours.  They stand here to be compared with, and say nothing about their authors' figures.
"""
