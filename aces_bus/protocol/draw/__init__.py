"""Pictures and tables of messages, from their plans: `text` for terminals, `svg` for pages, `table` for both."""
