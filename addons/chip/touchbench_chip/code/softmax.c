/* Scores as probabilities, in place. */
static void softmax(float *y, int classes)
{
    float most = y[0], sum = 0;
    for (int c = 1; c < classes; c++)
        most = fmaxf(most, y[c]);
    for (int c = 0; c < classes; c++)
        sum += y[c] = expf(y[c] - most);
    for (int c = 0; c < classes; c++)
        y[c] /= sum;
}
