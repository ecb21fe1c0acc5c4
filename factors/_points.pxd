# cython: language_level=3


cdef struct View:  # of a vehicle from a sensor, in the object frame
    double half[3]  # of length, height and width
    double middle  # of the cuboid, along the second axis
    double sensor[3]
    double scale[3]  # to the mean shape's size
    double scaled[3]  # the sensor there


cdef enum Form:  # as `factors.mixture.Form`
    WEIGHTED = 0
    LOSS = 1
    NEWTON = 2
    MAJORISED = 3


cdef void mixed(
    int form, double right, double wrong, double weight, double square, double *stretch, double *bend, double *loss
) noexcept nogil


cdef class Term:
    cdef readonly int coefficients
    cdef double add(
        self, const double *R, const double *t, const double *x, double most, double *g, double *M, double *J
    ) noexcept nogil


cdef class Points(Term):
    cdef readonly int count, shared
    cdef const double[:, ::1] points, patches, basis, along_normal, size_basis
    cdef const double[::1] sigma, along, origin, first, size, odds
    cdef double[::1] elsewhere_peak, inverse_best
    cdef const int[:, ::1] neighbours
    cdef const int[:, :, ::1] grid
    cdef double spacing, share, vehicle
    cdef double ratio(self, int i, const double *shared) noexcept nogil
    cdef void place(self, int i, const double *R, const double *t, const double *shared, double *local) noexcept nogil
    cdef int nearest(self, const double *local, const View *view, bint *facing) noexcept nogil
    cdef double off(self, int k, const double *local, const double *x) noexcept nogil
    cdef void trace(self, const double *x, const View *view, const double *unit, double *met) noexcept nogil
    cdef double elsewhere(self, int i, const double *local, const View *view, double far) noexcept nogil
    cdef bint goes_on(self, const double *local, const View *view) noexcept nogil
    cdef int measure(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const View *view,
        double *local, double *gain, double *beyond, double *wrong, double *sigma, double *off
    ) noexcept nogil
    cdef int match_one(
        self, int i, const double *R, const double *t, const double *x, const double *shared, const View *view,
        double *local, double *right, double *wrong, double *sigma
    ) noexcept nogil
    cdef void prepare(self, const double *R, const double *t, const double *x, View *view) noexcept nogil
    cdef void row(
        self, int i, int k, const double *R, const double *local, const double *shared, double factor, double *J
    ) noexcept nogil
