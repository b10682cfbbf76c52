"""The command line: arguments in, calls to the library, sentences and JSON out."""
