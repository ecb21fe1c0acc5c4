#!/usr/bin/env bash
# odrpack 0.7.0, odr_fit(...): sd_beta, "standard deviations of the estimated parameters", and cov_beta, their "covariance matrix".
#
# Guess: sd_beta is the square root of cov_beta's diagonal, and both are what the parameters scatter by.
# Seen: sd_beta is what they scatter by; cov_beta is not yet multiplied by the variance of the residuals (res_var). Of a line through points that are
# good to 5 and 10 cm it tells 16 times the deviation (in metres; in centimetres 0.16 of it): a covariance whose size depends on the unit.
# scipy.odr, from which people come, has the same, and says so since its issue 6842; here the fields are described as above.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet odrpack==0.7.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import numpy as np
from odrpack import odr_fit

rng = np.random.default_rng(0)
true = np.linspace(0, 10, 40)  # m
for unit, name in ((1, "metres"), (100, "centimetres")):
    fits, deviations, variances, residuals = [], [], [], []
    for _ in range(300):
        x, y = true + rng.normal(0, 0.05, 40), 2 * true + 1 + rng.normal(0, 0.1, 40)
        fit = odr_fit(lambda x, line: line[0] * x + line[1], x * unit, y * unit, beta0=np.array([1.0, 0.0]))
        fits.append(fit.beta)
        deviations.append(fit.sd_beta)
        variances.append(np.diag(fit.cov_beta))
        residuals.append(fit.res_var)
    scatter, told, of_covariance = np.std(fits, axis=0), np.mean(deviations, axis=0), np.sqrt(np.mean(variances, axis=0))
    print(f"{name}: the line scatters by {scatter}, sd_beta {told}, from cov_beta {of_covariance}, ratio {(of_covariance / scatter).round(2)}")
    assert (abs(told / scatter - 1) < 0.15).all() and (abs(of_covariance / scatter / (16 / unit) - 1) < 0.15).all()
    assert np.allclose(np.array(deviations) ** 2, np.array(variances) * np.array(residuals)[:, None])
PYTHON
