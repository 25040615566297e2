using System.Collections;
using System.IO;
using UnityEngine;
using UnityEngine.Networking;

/// <summary>A texture that plays through this object's AudioSource, whose output drives an actuator.</summary>
[RequireComponent(typeof(AudioSource))]
public sealed class FotenSource : MonoBehaviour
{
    [Tooltip("A file in StreamingAssets")] public string file = "denim.foten";
    [Tooltip("Full scale for 1 m/s²")] public float gain = 0.02f;
    [Tooltip("mm/s")] public float speed;
    [Tooltip("N")] public float force;

    private readonly object rendering = new object(); // held by the audio thread as it renders, and to change what it renders from
    private Foten.Texture texture;
    private Foten.Renderer renderer;
    private float[] mono = new float[0];

    private IEnumerator Start()
    {
        // Not File.ReadAllBytes: on Android and Quest these assets lie within the package.
        string path = Path.Combine(Application.streamingAssetsPath, file);
        using (var request = UnityWebRequest.Get(path.Contains("://") ? path : "file://" + path))
        {
            yield return request.SendWebRequest();
            if (request.result != UnityWebRequest.Result.Success)
            {
                Debug.LogError($"{path}: {request.error}");
                yield break;
            }
            try
            {
                var loaded = new Foten.Texture(request.downloadHandler.data);
                var made = new Foten.Renderer(loaded, AudioSettings.outputSampleRate, smooth: true);
                lock (rendering) { texture = loaded; renderer = made; }
            }
            catch (Foten.FotenException error)
            {
                Debug.LogError($"{path}: {error.Message}");
            }
        }
    }

    private void OnDestroy()
    {
        lock (rendering)
        {
            renderer?.Dispose();
            texture?.Dispose();
            renderer = null;
        }
    }

    // Without the lock: a condition is set while it renders, and what is freed is freed on this thread.
    private void Update() => renderer?.SetCondition(speed, force);

    // On the audio thread.
    private void OnAudioFilterRead(float[] data, int channels)
    {
        int n = data.Length / channels;
        if (mono.Length < n) mono = new float[n];
        lock (rendering)
        {
            if (renderer == null) return;
            renderer.Render(mono, n);
        }
        for (int i = 0; i < n; i++)
            for (int c = 0; c < channels; c++)
                data[i * channels + c] = Mathf.Clamp(gain * mono[i], -1f, 1f);
    }
}
