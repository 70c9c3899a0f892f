/* What a classifier makes of features. */

/* Features in the units of a classifier: (x - a) b + c; no c is 0. */
static void measured(const float *x, const float *a, const float *b, const float *c, float *z)
{
    for (int i = 0; i < FEATURES; i++)
        z[i] = (x[i] - a[i]) * b[i] + (c ? c[i] : 0);
}

/* Outputs of a layer: weights [outputs][inputs], each row in steps of its own. */
static void layer(const weight_t *weights, const float *step, const float *bias, int outputs, int inputs, const float *x,
                  float *y)
{
    for (int o = 0; o < outputs; o++) {
        float sum = 0;
        for (int i = 0; i < inputs; i++)
            sum += (float)weights[o * inputs + i] * x[i];
        y[o] = sum * step[o] + bias[o];
    }
}

/* Scores as probabilities, in place. */
static void softmax(float *y)
{
    float most = y[0], sum = 0;
    for (int c = 1; c < CLASSES; c++)
        most = fmaxf(most, y[c]);
    for (int c = 0; c < CLASSES; c++)
        sum += y[c] = expf(y[c] - most);
    for (int c = 0; c < CLASSES; c++)
        y[c] /= sum;
}
