"""The one error family of the package. A pose that is not found is a verdict, never one of these."""


class SvcError(Exception):
    """Base of every error that this package raises on purpose."""


class InputError(SvcError, ValueError):
    """Broken input from outside; the message names what was expected, what was found and where."""


class UnsupportedCloudError(InputError):
    """A point cloud whose layout or content cannot be read as a scan."""


class TooFewPointsError(InputError):
    """A scan with fewer usable points than the registration needs."""


class ConfigError(SvcError, ValueError):
    """An unknown name, a value outside its range, or values that exclude each other."""


class DescriptorError(SvcError):
    """A descriptor of `matching.more_descriptors` that failed, or gave what is no description; the message names it."""


class TransformUnavailableError(SvcError, LookupError):
    """A transform between two frames that the recorded or received data does not contain."""


class MissingDependencyError(SvcError, ImportError):
    """An optional package that a call needs; the message says how to install it."""
