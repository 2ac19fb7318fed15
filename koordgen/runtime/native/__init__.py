"""Loader of C code, and compilation of the runtime's own modules.

Owns: compilation on the robot, the cache of libraries, the check of a library before its use, and the list of runtime
    modules that can be compiled.
Offers: `loader.load`, `protocol.use`, `protocol.compile_modules`.
Must not import: any other package. Each C source is in the folder of the module that binds it.
"""
