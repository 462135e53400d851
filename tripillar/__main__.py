"""`python -m tripillar` is `tripillar`."""

from tripillar.cli.app import main

main()
