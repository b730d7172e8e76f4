"""What all parts of the page share: context, commands, events, texts, markup, screen state.

May import the package, and of the viewer nothing but itself.
"""
