/* Decision values of one class against another, from kernels with the support vectors, and the votes they make. */
static void machine(int classes, int linear, float gamma, const float *z, const touch_vector_t *vectors, const float *step,
                    const float *dual, const float *intercept, const int *first, float *kernel, float *y)
{
    float votes[CLASSES] = {0}, sure[CLASSES] = {0}; /* no function has more classes */
    for (int v = 0; v < first[classes]; v++) {
        float sum = 0;
        for (int i = 0; i < FEATURES; i++) {
            float value = (float)vectors[v * FEATURES + i] * step[i];
            sum += linear ? value * z[i] : (value - z[i]) * (value - z[i]);
        }
        kernel[v] = linear ? sum : expf(-gamma * sum);
    }
    for (int a = 0, pair = 0; a < classes; a++)
        for (int b = a + 1; b < classes; b++, pair++) {
            float sum = intercept[pair];
            for (int v = first[a]; v < first[a + 1]; v++)
                sum += dual[(b - 1) * first[classes] + v] * kernel[v];
            for (int v = first[b]; v < first[b + 1]; v++)
                sum += dual[a * first[classes] + v] * kernel[v];
            votes[sum < 0 ? b : a] += 1;
            sure[a] += sum;
            sure[b] -= sum;
        }
    for (int c = 0; c < classes; c++)
        y[c] = classes == 2 ? sure[c] : votes[c] + sure[c] / (3 * (fabsf(sure[c]) + 1));
}
