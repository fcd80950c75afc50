"""SimNFND factory: RGBD frames in, paired (noisy, clean) forward-looking-sonar images out.

Four suites, each of which imports only those before it: `common`, `dataset` (the format and its
reader), `simulation` (a frame to its pair; `simulation/pairs/pair_maker.py` is the whole method)
and `production` (scheduler, command line, exports).
"""

__version__ = "0.7.0"

if __name__ == "factory":
    from simnfnd.rooms import refuse_modules_of

    refuse_modules_of(__name__)
