"""Moving targets inserted into static recordings: what denoising leaves of them."""
