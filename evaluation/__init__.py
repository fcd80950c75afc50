"""Measures how good images are, and reports it: metrics, statistics, whole datasets."""

if __name__ == "evaluation":
    from simnfnd.rooms import refuse_modules_of

    refuse_modules_of(__name__)
