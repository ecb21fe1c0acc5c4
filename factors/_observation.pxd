# cython: language_level=3
"""What other compiled modules may use of an observation."""


cdef class Observation:
    cdef readonly int keypoints, coefficients, points, rows
    cdef const double[:, ::1] camera, mean, basis, pixels, whitener, outline, outline_basis
    cdef const double[::1] edges, normal, direction
    cdef const unsigned char[::1] used
    cdef double box_sigma, box_wrong, softness, distance, height_sigma, slope_sigma, tilt_sigma
    cdef bint has_box, has_ground
    cdef const double[:, :, ::1] table
    cdef const double[:, ::1] seen_from
    cdef const double[::1] elevations
    cdef const double[::1] right, outlier
    cdef const unsigned char[::1] measured
    cdef double gross, missed, false_alarm
    cdef const double[:, ::1] size_basis
    cdef const double[::1] size_mean
    cdef const double[::1] size_sigma
    cdef bint has_size, has_direction, is_bound

    cdef double keypoint(
        self, int k, const double *R, const double *t, const double *x, const double *offsets, double least,
        double *r, double *X, double *camera, double *body
    ) noexcept nogil
    cdef double box(
        self, const double *R, const double *t, const double *x, double least, double *r, double *J, double *crease,
        double *work
    ) noexcept nogil
    cdef void crease(
        self, int e, double beyond, const double *R, const double *U, const double *G, const double *X, double *row
    ) noexcept nogil
    cdef void ground(
        self, const double *R, const double *t, double height_sigma, double *r, double *turn, double *shift
    ) noexcept nogil
    cdef void visible(self, const double *R, const double *t, double *visibility) noexcept nogil
    cdef void densities(self, int k, double visibility, double *right, double *wrong) noexcept nogil
