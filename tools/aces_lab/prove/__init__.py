"""Proofs that generated codecs equal their spec for all inputs, with z3."""
