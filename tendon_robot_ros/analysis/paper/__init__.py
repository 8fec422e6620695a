"""The experiments of Kato et al. 2015 (doi 10.1109/TMECH.2014.2372635), section IV."""
