/* Features in the units of a classifier: (x - a) b + c; no c is 0. */
static void measured(const float *x, const float *a, const float *b, const float *c, float *z)
{
    for (int i = 0; i < FEATURES; i++)
        z[i] = (x[i] - a[i]) * b[i] + (c ? c[i] : 0);
}
