"""The page of `simnfnd view`, contact sheets, and the server of local pages."""
