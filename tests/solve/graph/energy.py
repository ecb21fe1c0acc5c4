"""The graph's whole energy for one observation, written out once more in plain numpy for other solvers to minimise.

Nothing of `factors` or `fgrecon.solve.graph` is used. Planes are parametrised otherwise: a normal is (a, 1, b) or, of
the medial plane, (a, b, 1), brought to length one; with the paper's penalty it is a free vector.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import Rotation

from fgrecon.core.size_prior import other_fleets


class Energy:
    """Residuals of one vehicle at fixed weights as a function of one vector.

    The vector holds the pose's change (rotation vector about the object's axes and translation along them) where the
    pose is free, then lambda, then the offsets where they are free, then the planes.
    """

    def __init__(self, problem, covariances, weights, camera_T_object, *, joint):
        self.problem, self.joint, self.pose = problem, joint, camera_T_object
        self.prior, self.options = problem.model.prior, problem.options
        self.category = self.prior.category
        self.weights, self.box_weights = weights.keypoints, weights.box
        self.visibility, self.depth = weights.visibility, weights.depth  # the ground's uncertainty belongs to a depth
        self.whiteners = [_inverse_root(covariance) for covariance in covariances]
        free = self.options.shape.free_offsets
        self.symmetric = self.prior.is_symmetric and not free
        self.faces = [
            face
            for face in self.category.faces
            if face.ground_parallel or not (self.symmetric and self._mirrored(face))
        ]
        if "planarity" in self.options.disabled_terms or not (free or self.prior.dimension):
            self.faces = []
        self.medial = not self.symmetric and "symmetry" not in self.options.disabled_terms
        self.penalty = self.options.shape.plane_penalty
        self.sizes = [6 * joint, self.prior.dimension, 3 * self.category.size * free]
        self.sizes += [3 if self.penalty is None else 4] * len(self.faces) + [3] * self.medial

    def _mirrored(self, face):
        return {int(self.category.mirror[k]) for k in face.keypoints} == set(face.keypoints)

    def split(self, x):
        return np.split(x, np.cumsum(self.sizes)[:-1])

    def pose_at(self, x):
        change = self.split(x)[0]
        if not self.joint:
            return self.pose
        pose = self.pose.copy()
        pose[:3, :3] = self.pose[:3, :3] @ Rotation.from_rotvec(change[:3]).as_matrix()
        pose[:3, 3] += self.pose[:3, :3] @ change[3:]
        return pose

    def points_at(self, x):
        _, coefficients, offsets, *_ = self.split(x)
        points = self.prior.mean + sum(c * b for c, b in zip(coefficients, self.prior.basis, strict=True))
        return points + offsets.reshape(-1, 3) if len(offsets) else points

    def _whitened(self, coefficients):
        """By the prior; where no fleet is given, by that and by how far fleets differ."""
        if self.problem.model.fleet_given or not len(coefficients):
            return coefficients
        sizes = np.einsum("dki,nki->dn", self.category.dimension_operator, self.prior.basis)
        by_size, mean = np.linalg.pinv(sizes), self.prior.box_size(np.zeros(self.prior.dimension))
        spread = np.eye(len(coefficients)) + by_size @ other_fleets(mean) @ by_size.T
        return np.linalg.solve(np.linalg.cholesky(spread), coefficients)

    def start(self, coefficients, offsets):
        """The vector at the pose, with planes through the mean heights of their faces."""
        x = [np.zeros(self.sizes[0]), coefficients, offsets.ravel() if self.options.shape.free_offsets else np.zeros(0)]
        points = self.prior.keypoints(coefficients, offsets)
        for face in self.faces:
            height = -points[list(face.keypoints), 1].mean()
            x.append(np.array([0, 0, height]) if self.penalty is None else np.array([0, 1, 0, height]))
        if self.medial:
            x.append(np.zeros(3))
        return np.concatenate(x)

    def terms(self, x):
        """Whitened residuals by name."""
        options, problem = self.options, self.problem
        _, coefficients, offsets, *planes = self.split(x)
        pose, points = self.pose_at(x), self.points_at(x)
        terms = {"reprojection": self._reprojection(pose, points), "coefficients": self._whitened(coefficients)}
        if len(offsets):
            spread = np.maximum(self.prior.offset_sigma, 1e-4).reshape(self.category.size, -1)
            sigma = spread * np.ones(3)
            if "symmetry" not in options.disabled_terms:  # two that are nearly one
                sigma[self.category.mirror != np.arange(self.category.size)] *= np.sqrt(2.0)
            terms["offsets"] = offsets / sigma.ravel()
        planarity = []
        for face, plane in zip(self.faces, planes, strict=False):
            if self.penalty is None:
                n, d = np.array([plane[0], 1.0, plane[1]]) / np.sqrt(1 + plane[0] ** 2 + plane[1] ** 2), plane[2]
            else:
                n, d = plane[:3], plane[3]
                planarity.append(np.sqrt(self.penalty) * (1 - n @ n) / options.shape.planarity_sigma)
            planarity += [(n @ points[k] + d) / options.shape.planarity_sigma for k in face.keypoints]
            if face.ground_parallel:
                planarity += [n[0] / options.shape.parallel_sigma, n[2] / options.shape.parallel_sigma]
        terms["planarity"] = np.array(planarity)
        terms["rectangularity"] = np.concatenate([self._rectangle(points, face) for face in self.category.faces])
        if self.medial:
            terms["symmetry"] = self._symmetry(points, planes[-1])
        if problem.model.size is not None:
            size = problem.model.size
            measured = np.array([self._dimension(points, dimension) for dimension in self.category.dimensions])
            terms["dimensions"] = (measured - size.mean) / size.assumed_sigma
        usual = 0.0 if options.shape.literal_laplacian else self._delta(self.prior.mean)
        terms["laplacian"] = (self._delta(points) - usual).ravel() / options.shape.laplacian_sigma
        if self.joint and problem.ground is not None:
            ground = problem.ground
            height = (ground.normal @ pose[:3, 3] - ground.distance) / self.height_sigma
            terms["ground"] = np.append((pose[:3, 1] - ground.normal) / ground.tilt_sigma, height)
        if problem.energy.box is not None:
            terms["box"] = self._box(pose, coefficients)
        return {name: term for name, term in terms.items() if name not in options.disabled_terms}

    @property
    def height_sigma(self):
        """Standard deviation of the height above the ground."""
        ground = self.problem.ground
        return np.hypot(ground.height_sigma, ground.slope_sigma * self.depth)

    def robust(self, x):
        """Negative log-likelihood with visibility held: keypoints and edges are mixtures, all else is Gaussian."""
        term, box, terms = self.problem.energy.keypoints, self.problem.energy.box, self.terms(x)
        strategy, right, visible = term.strategy, term.evidence.right, self.visibility
        pixels, total = self._project(self.pose_at(x), self.points_at(x)), 0.0
        for k in np.flatnonzero(self.problem.observation.measured):
            d = self.whiteners[k] @ (pixels[k] - self.problem.observation.keypoints[k])
            seen = visible[k] * right[k]
            inlier = seen * (1 - strategy.gross) * np.exp(-0.5 * d @ d)
            outlier = seen * strategy.gross + (1 - visible[k]) * right[k] * strategy.false_alarm
            outlier += visible[k] * (1 - right[k]) * strategy.missed
            outlier += (1 - visible[k]) * (1 - right[k]) * (1 - strategy.false_alarm)
            total -= np.log(inlier + outlier * term.evidence.outlier[k])
        if "box" in terms:
            away = self._edges(self.pose_at(x), self.split(x)[1])[box.rows.used]
            total -= np.sum(np.log(np.exp(-0.5 * away**2) + box.rows.wrong))
        return total + sum(0.5 * np.sum(term**2) for name, term in terms.items() if name not in ("reprojection", "box"))

    def residual(self, x):
        return np.concatenate(list(self.terms(x).values()))

    def cost(self, x):
        return 0.5 * float(np.sum(self.residual(x) ** 2))

    def jacobian(self, x, step=1e-6):
        """Central differences."""
        columns = [(self.residual(x + step * e) - self.residual(x - step * e)) / (2 * step) for e in np.eye(len(x))]
        return np.array(columns).T

    def _project(self, pose, points):
        q = (points @ pose[:3, :3].T + pose[:3, 3]) @ self.problem.camera.matrix.T
        return q[:, :2] / q[:, 2:]

    def _reprojection(self, pose, points):
        pixels, rows = self._project(pose, points), []
        for k in np.flatnonzero(self.problem.observation.measured):
            d = pixels[k] - self.problem.observation.keypoints[k]
            rows.append(np.sqrt(self.weights[k]) * self.whiteners[k] @ d)
        return np.concatenate(rows)

    def _dimension(self, points, dimension):
        ends = points[list(dimension.plus)].mean(axis=0) - points[list(dimension.minus)].mean(axis=0)
        return abs(ends[{"length": 0, "width": 2, "height": 1}[dimension.name]]) / dimension.ratio

    def _rectangle(self, points, face):
        if not face.rectangular:
            return np.zeros(0)
        a, b, c, d = points[list(face.keypoints)]
        diagonals = np.linalg.norm(a - c) - np.linalg.norm(b - d)
        return np.append(a - b + c - d, diagonals) / self.options.shape.rectangularity_sigma

    def _symmetry(self, points, plane):
        n = np.array([plane[0], plane[1], 1.0]) / np.sqrt(1 + plane[0] ** 2 + plane[1] ** 2)
        left, right = np.array(self.category.symmetric_pairs).T
        mirrored = points[right] - 2 * np.outer(points[right] @ n + plane[2], n)
        middle = points[self.category.mirror == np.arange(self.category.size)] @ n + plane[2]
        return np.concatenate([(mirrored - points[left]).ravel(), middle]) / self.options.shape.symmetry_sigma

    def _delta(self, points):
        rows = []
        for i, near in enumerate(self.category.neighbours):
            if near:
                others = points[list(near)]
                weight = np.exp(-np.sum((points[i] - others) ** 2, axis=1))
                literal = self.options.shape.literal_laplacian
                rows.append(points[i] - weight @ others / (1.0 if literal else weight.sum()))
        return np.array(rows)

    def _box(self, pose, coefficients):
        box = self.problem.energy.box
        return np.sqrt(self.box_weights * box.rows.used) * self._edges(pose, coefficients)

    def _edges(self, pose, coefficients):
        box, rows = self.problem.energy.box, []
        points = box.mean + sum(c * b for c, b in zip(coefficients, box.basis, strict=True))
        pixels = self._project(pose, points)
        for edge in range(4):
            sign = -1.0 if edge < 2 else 1.0
            outward = sign * pixels[:, edge % 2]
            share = np.exp((outward - outward.max()) / box.rows.softness)
            extent = sign * (share @ outward) / share.sum()
            rows.append((extent + sign * box.rows.inside[edge] - box.rows.edges[edge]) / box.rows.sigma)
        return np.array(rows)


def minimise_by_scipy(energy, x):
    """Optimum by scipy's trust region."""
    return least_squares(energy.residual, x, jac=energy.jacobian, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-13).x


class Whitened:
    """The robust energy around a point, in coordinates in which its Gauss-Newton matrix there is the identity."""

    def __init__(self, energy, x):
        jacobian = energy.jacobian(x)
        self.energy, self.centre = energy, x
        self.scale = np.linalg.inv(np.linalg.cholesky(jacobian.T @ jacobian)).T

    def at(self, y):
        return self.centre + self.scale @ y

    def __call__(self, y):
        return self.energy.robust(self.at(y))

    def gradient(self, y, step=1e-3):
        """Central differences of fourth order."""
        ahead = [[self(y + s * step * e) for s in (-2, -1, 1, 2)] for e in np.eye(len(y))]
        return np.array(ahead) @ [1, -8, 8, -1] / (12 * step)

    def minimise(self, y):
        """Optimum by scipy's quasi-Newton method from a place nearby, in the energy's own coordinates."""
        return self.at(minimize(self, y, jac=self.gradient, method="BFGS", options={"gtol": 1e-8}).x)


def minimise_by_ceres(energy, x):
    """Optimum by Ceres; needs pyceres."""
    import pyceres

    class Cost(pyceres.CostFunction):
        def __init__(self):
            super().__init__()
            self.set_num_residuals(len(energy.residual(x)))
            self.set_parameter_block_sizes([len(x)])

        def Evaluate(self, parameters, residuals, jacobians):
            residuals[:] = energy.residual(parameters[0])
            if jacobians is not None:
                jacobians[0][:] = energy.jacobian(parameters[0]).ravel()
            return True

    found = np.array(x, dtype=np.float64)
    problem = pyceres.Problem()
    cost = Cost()
    problem.add_residual_block(cost, None, [found])
    options = pyceres.SolverOptions()
    options.max_num_iterations = 200
    options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 1e-16
    options.minimizer_progress_to_stdout = False
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, problem, pyceres.SolverSummary())
    return found


def _inverse_root(covariance):
    """Symmetric inverse square root, by eigenvectors."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors @ np.diag(values**-0.5) @ vectors.T
