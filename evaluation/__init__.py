"""How good are the images: metrics, measurements over whole datasets, reports."""

if __name__ == "evaluation":
    from simnfnd.rooms import refuse_modules_of

    refuse_modules_of(__name__)
