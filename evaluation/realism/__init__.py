"""How near are simulated sonar pictures to real ones?

    real pictures  --real.py------+
                                  +-> polar pictures -> measure.py -> compare.py -> report.py
    a dataset      --simulated.py-+

Every distance between real and simulated pictures stands beside the one between two halves of the
real ones: the baseline that a perfect simulation would reach, and no more.
"""
