"""For the authors of protocols: begin a spec, check it, see it, explain what it
does, carry it to and from other formats.
"""

#: Action → its module in this package, and what it is for; as VERBS of `main`.
ACTIONS: dict[str, tuple[str, str]] = {
    "new": ("authoring.new", "begin a protocol: a commented spec, a test, a README"),
    "check": (
        "authoring.check",
        "what is wrong or doubtful in specs and on buses; file:line",
    ),
    "show": (
        "authoring.show",
        "how messages are laid out and decoded; --diff",
    ),
    "explain": ("authoring.explain", "why a word of a capture is decoded as it is, template by template"),
    "stubs": ("authoring.stubs", "stubs of the records, for editors and type checkers"),
    "export": ("authoring.export", "DBC, a Wireshark dissector, pages in Markdown"),
    "import": ("authoring.importing", "a DBC, KCD, SYM, ARXML or EDS file as spec source to edit"),
}
