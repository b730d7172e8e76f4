"""What a command line says."""


def refused(result, code=2):
    """What a command line says on stderr that ends with this exit code."""
    assert result.exit_code == code, result.output
    return result.stderr
