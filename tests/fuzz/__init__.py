"""Damaged and hostile files by the thousand: ``make fuzz``, ``python -m tests.fuzz --raws 100000 --seed 0``.

A trial changes a good file (``seeds.py``) by what its format is made of (``bytewise.py``, ``tiffs.py``,
``containers.py``, ``words.py``), hands it to the reader that a user's command would call (``targets.py``), and says
what came of it: it was read, it was refused by one of our errors in one line that names the file, or the reader failed
(``outcomes.py``). Trials run in child processes, thousands in each (``child.py``); one that dies, hangs or takes too
much memory costs its one trial (``running.py``). Trial ``n`` of a kind is the same in every run with the same seed,
whatever the number of processes. Every input that makes a reader fail is kept, with the line that runs it again.

Why no library does this:

- atheris guides mutations by coverage, of Python code and of C code that was built for it. The
  crashes are in wheels of LibRaw, HDF5 and numpy that nobody built for it. It runs in the process that it tests, so the
  first crash ends it; what changes a TIFF's tags or mends an archive's checksums would be ours with it as well;
  and it has no wheels for the newest Python, nor for macOS.
- Hypothesis looks for the smallest example of one broken property, in one process that must survive. The properties of
  single functions are tested with it (``tests/base/test_fields.py``); 100,000 files of 10 kB are not what it is for.

What is needed of either, a loop over seeded changes and a process to lose, is short.
"""
