"""How near are simulated sonar pictures to real ones, beside real ones to each other?"""
