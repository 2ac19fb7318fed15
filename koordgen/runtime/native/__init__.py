"""Loader of C code.

Owns: compilation on the robot, the cache of libraries, the check of a library before it is used; which modules of the
    runtime can run compiled.
Offers: `loader.load`, `protocol.use`, `protocol.compile_modules`.
Must not import: any other package. C sources stand beside the module that binds them.
"""
