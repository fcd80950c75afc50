"""What is measured on one polar picture: speckle, grain and texture, artefacts, fixed features."""
