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
