"""Pages of the docs site that are written from the code when the site is built (`make docs`)."""
