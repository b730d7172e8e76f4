"""The Viam integration: models, their configuration, a client for a machine's arm.

``models`` has one file a model, ``conversion`` turns Viam's types into ours, ``requests`` answers
DoCommands, ``client`` drives an arm of a running machine. It may import everything but ``cli``.
"""
