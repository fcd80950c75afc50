"""SimNFND factory: RGBD frames in, paired (noisy, clean) forward-looking-sonar images out.

Read `pairs.py` first: it is the whole method in one screen.  Every other room does one stage of it
(scenes -> cloud -> render -> noise -> resample -> sonar) or carries its result (shards, scheduler).
"""

__version__ = "0.4.0"

if __name__ == "factory":
    from simnfnd.rooms import refuse_modules_of

    refuse_modules_of(__name__)
