"""A program in the lanes of the processor: a run (`loop`), or a row of an array (`rows`), in each."""
