"""Which effects to add: score tests, screening, forward selection, backward elimination."""
