"""The views of the studio: each is a file of this folder that names its class `VIEW`, and is found by being there."""
