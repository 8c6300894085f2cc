"""Declaring: fields, templates, messages, protocols, and what is wrong with them."""
